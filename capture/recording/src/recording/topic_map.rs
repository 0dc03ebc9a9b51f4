//! Names of topics in other people's recordings.

use crate::error::ReadError;
use crate::topic;

/// Topics that a recording may be read from, by the names of the contract.
const KNOWN: [&str; 8] = [
    topic::WRENCH,
    topic::TCP_POSE,
    topic::ARIA_POSE,
    topic::GRIPPER,
    topic::TEMPERATURE,
    topic::IMU,
    topic::TF_STATIC,
    topic::MARKS,
];

/// Which topic of a recording takes the place of which topic of the contract.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicMap {
    pairs: Vec<(String, String)>,
}

impl TopicMap {
    /// A map from `--map` arguments, `/their/topic=/ft/wrench`.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn from_arguments<'a>(
        arguments: impl IntoIterator<Item = &'a str>,
    ) -> Result<Self, ReadError> {
        let mut map = Self::default();
        for argument in arguments {
            map.add(argument)?;
        }
        Ok(map)
    }

    /// Takes in one `--map` argument, `/their/topic=/ft/wrench`.
    ///
    /// # Errors
    /// When it has another shape, or the right side is no topic of the contract or was named before.
    pub fn add(&mut self, argument: &str) -> Result<(), ReadError> {
        let wrong = |reason| {
            Err(ReadError::Map {
                argument: argument.to_owned(),
                reason,
            })
        };
        let Some((from, to)) = argument.split_once('=') else {
            return wrong("must look like /their/topic=/ft/wrench");
        };
        if from.is_empty() {
            return wrong("names no topic before the =");
        }
        if !KNOWN.contains(&to) {
            return wrong(
                "the name after the = must be one of /ft/wrench, /tcp/pose, /aria/pose, /gripper/joint_states, \
                 /ft/temperature, /ft/imu, /tf_static, /marks",
            );
        }
        if self
            .pairs
            .iter()
            .any(|(known_from, known_to)| known_from == from || known_to == to)
        {
            return wrong("names a topic that an earlier --map named");
        }
        self.pairs.push((from.to_owned(), to.to_owned()));
        Ok(())
    }

    /// The contract's name of a recording's topic; `None` when another topic takes its place.
    #[must_use]
    pub fn resolve<'a>(&'a self, topic: &'a str) -> Option<&'a str> {
        let mapped = self
            .pairs
            .iter()
            .find(|(from, _)| from == topic)
            .map(|(_, to)| to.as_str());
        let replaced = self.pairs.iter().any(|(_, to)| to == topic);
        mapped.or((!replaced).then_some(topic))
    }

    /// The topics that must be in the recording.
    pub(crate) fn sources(&self) -> impl Iterator<Item = &str> {
        self.pairs.iter().map(|(from, _)| from.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapped_topic_takes_the_place_of_its_namesake() {
        let map = TopicMap::from_arguments(["/their/ft=/ft/wrench"]).unwrap();
        assert_eq!(map.resolve("/their/ft"), Some("/ft/wrench"));
        assert_eq!(map.resolve("/ft/wrench"), None);
        assert_eq!(map.resolve("/aria/pose"), Some("/aria/pose"));
    }

    #[test]
    fn wrong_arguments_say_what_is_right() {
        for (argument, expected) in [
            ("/a", "--map /a: must look like /their/topic=/ft/wrench"),
            (
                "=/ft/wrench",
                "--map =/ft/wrench: names no topic before the =",
            ),
        ] {
            assert_eq!(
                TopicMap::default().add(argument).unwrap_err().to_string(),
                expected
            );
        }
        let message = TopicMap::default().add("/a=/b").unwrap_err().to_string();
        assert!(
            message.contains("one of /ft/wrench, /tcp/pose"),
            "{message}"
        );
        let twice = TopicMap::from_arguments(["/a=/tcp/pose", "/b=/tcp/pose"]).unwrap_err();
        assert_eq!(
            twice.to_string(),
            "--map /b=/tcp/pose: names a topic that an earlier --map named"
        );
    }
}
