//! Arbitrary bytes for `ft_wire::pose_stream`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::pose_stream::decode(data), data);
});
