//! Arbitrary bytes for `ft_wire::optoforce_hex`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::optoforce_hex::decode(data), data);
    ft_fuzz::whole(ft_wire::optoforce_hex::decode_command(data), data);
});
