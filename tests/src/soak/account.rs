//! What became of every frame.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use ft_capture::item::Body;

use super::player::Kind;

/// What a player did to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    Whole,
    /// Sent twice.
    Twice,
    /// A bit flipped, or a part of it left out.
    Spoiled,
    /// Left out as a whole.
    Lost,
}

/// A frame as it was sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    pub(super) number: u64,
    /// Counts up with each unplugging and each silence.
    pub(super) stretch: u32,
    pub(super) fate: Fate,
    /// Bytes that belong to no frame went before it.
    pub(super) noise: bool,
}

/// Frames that are on their way, the oldest first.
pub(super) type Account = Arc<Mutex<VecDeque<Sent>>>;

/// What became of the frames of one device.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Delivered as samples, each once, with the values that were sent.
    pub delivered: u64,
    /// Spoiled on the way.
    pub spoiled: u64,
    /// Lost as a whole on the way.
    pub lost: u64,
    /// Sent twice, delivered once.
    pub twice: u64,
    /// Noise between frames.
    pub noise: u64,
    /// Between the last sample before an unplugging or a silence and the first one after it: in the cable, or sent while the driver
    /// set the device up.
    pub interrupted: u64,
    /// Whole, and not delivered though the stream went on. None may be.
    pub missing: u64,
    /// Samples with values that were not sent, or for the second time. None may be.
    pub wrong: u64,
    /// The first of these.
    pub wrong_sample: Option<String>,
}

/// Frames that are sent while a driver sets its device up again after a silence, at four times the rate, and more.
const MOST_ON_THEIR_WAY: usize = 1 << 13;

/// An empty account whose memory is there from the beginning, so that it does not look like a leak.
pub(super) fn opened() -> Account {
    let mut entries = VecDeque::from(vec![NOTHING; MOST_ON_THEIR_WAY]);
    entries.clear();
    Arc::new(Mutex::new(entries))
}

const NOTHING: Sent = Sent {
    number: 0,
    stretch: 0,
    fate: Fate::Whole,
    noise: false,
};

/// Holds samples against the account.
#[derive(Debug)]
pub(super) struct Checker {
    kind: Kind,
    account: Account,
    /// Stretch of the sample before.
    stretch: Option<u32>,
    skipped: Vec<Sent>,
    tally: Tally,
}

impl Checker {
    pub(super) fn new(kind: Kind, account: Account) -> Self {
        let mut skipped = vec![NOTHING; MOST_ON_THEIR_WAY];
        skipped.clear();
        Self {
            kind,
            account,
            stretch: None,
            skipped,
            tally: Tally::default(),
        }
    }

    pub(super) fn sample(&mut self, body: &Body) {
        match self.kind.number(body).and_then(|number| self.find(number)) {
            Some(sent) if matches!(sent.fate, Fate::Whole | Fate::Twice) => self.deliver(sent),
            sent => {
                self.tally.wrong += 1;
                let told = || format!("(first: {body:?}, {sent:?})");
                self.tally.wrong_sample.get_or_insert_with(told);
            }
        }
    }

    /// The frame of that number; those before it are `skipped`.
    fn find(&mut self, number: u64) -> Option<Sent> {
        let mut account = self.account.lock().unwrap_or_else(PoisonError::into_inner);
        self.skipped.clear();
        let ahead = account.iter().position(|sent| sent.number == number)?;
        self.skipped.extend(account.drain(..ahead));
        account.pop_front()
    }

    fn deliver(&mut self, sent: Sent) {
        let goes_on = self.stretch.replace(sent.stretch) == Some(sent.stretch);
        let tally = &mut self.tally;
        tally.delivered += 1;
        tally.noise += u64::from(goes_on && sent.noise);
        tally.twice += u64::from(sent.fate == Fate::Twice);
        for skipped in &self.skipped {
            match skipped.fate {
                _ if !goes_on => tally.interrupted += 1,
                Fate::Spoiled => tally.spoiled += 1,
                Fate::Lost => tally.lost += 1,
                Fate::Whole | Fate::Twice => tally.missing += 1,
            }
        }
    }

    /// What never came is missing: the player ends with whole frames.
    pub(super) fn close(mut self) -> Tally {
        let account = self.account.lock().unwrap_or_else(PoisonError::into_inner);
        self.tally.missing += account.len() as u64;
        drop(account);
        self.tally
    }
}
