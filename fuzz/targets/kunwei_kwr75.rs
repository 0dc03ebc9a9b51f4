//! Arbitrary bytes for `ft_wire::kunwei_kwr75`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::kunwei_kwr75::decode(data), data);
});
