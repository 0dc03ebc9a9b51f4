//! Arbitrary bytes for `ft_wire::amt21`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(reply) = <[u8; 2]>::try_from(data) {
        let _ = ft_wire::amt21::decode_position(reply);
    }
});
