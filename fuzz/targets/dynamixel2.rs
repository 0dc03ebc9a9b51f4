//! Arbitrary bytes for `ft_wire::dynamixel2`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::dynamixel2::decode(data), data);
});
