//! Arbitrary bytes for `ft_wire::ati_netcanoem`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Some((base, frame)) = ft_fuzz::can(data) {
        let _ = ft_wire::ati_netcanoem::decode(base, &frame);
    }
});
