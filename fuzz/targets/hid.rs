//! Arbitrary bytes for `ft_wire::hid`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let (descriptor, report) = data.split_at(data.len().saturating_sub(16));
    for axis in ft_wire::hid::axes(descriptor).unwrap_or_default() {
        let value = axis.read(report);
        if let Ok(Some(value)) = value {
            assert!(value >= axis.logical.0 && value <= axis.logical.1);
        }
        let _ = axis.radians_per_count();
    }
});
