//! Arbitrary bytes for `ft_wire::encoder_line`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::encoder_line::decode(data), data);
});
