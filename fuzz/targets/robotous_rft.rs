//! Arbitrary bytes for `ft_wire::robotous_rft`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::robotous_rft::decode_response(data), data);
    ft_fuzz::whole(ft_wire::robotous_rft::decode_command(data), data);
});
