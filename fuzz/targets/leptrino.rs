//! Arbitrary bytes for `ft_wire::leptrino`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::leptrino::decode(data), data);
});
