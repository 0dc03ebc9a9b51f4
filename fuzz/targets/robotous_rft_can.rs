//! Arbitrary bytes for `ft_wire::robotous_rft`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Some((_, frame)) = ft_fuzz::can(data) {
        let _ = ft_wire::robotous_rft::decode_half(Default::default(), &frame);
    }
    if let (Some(first), Some(second)) = (data.first_chunk(), data.last_chunk()) {
        let _ = ft_wire::robotous_rft::join(*first, *second);
    }
});
