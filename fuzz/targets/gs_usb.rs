//! Arbitrary bytes for `ft_wire::gs_usb`.
#![no_main]

use ft_wire::gs_usb::{Content, HostFrame, Limits, Stamps, channels, encode};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    for stamps in [Stamps::Absent, Stamps::Carried] {
        let Ok(frame) = HostFrame::decode(data, stamps) else {
            continue;
        };
        // What is a data frame can be sent, and comes back the same.
        if let Content::Data(data) = frame.content {
            let sent = encode(u32::MAX, frame.channel, &data);
            let back = HostFrame::decode(&sent, Stamps::Absent).map(|frame| frame.content);
            assert_eq!(back, Ok(frame.content));
        }
    }
    let _ = channels(data);
    if let Some((answer, rate)) = data.split_first_chunk::<40>()
        && let (Ok(limits), Some(rate)) = (Limits::decode(answer), rate.first_chunk())
        && let Some(timing) = limits.timing(u32::from_le_bytes(*rate))
    {
        assert!(timing.divisor >= 1 && timing.encode().len() == 20);
    }
});
