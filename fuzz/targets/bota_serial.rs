//! Arbitrary bytes for `ft_wire::bota_serial`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ft_fuzz::whole(ft_wire::bota_serial::decode(data), data);
    ft_fuzz::whole(ft_wire::bota_serial::decode_ack(data), data);
    let _ = ft_wire::bota_serial::decode_boot_line(data);
});
