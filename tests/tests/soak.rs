//! Devices with faults before the real link threads, and eight sensors at once: a short run of each; `--bin soak` makes long ones.

use ft_tests::programs;

#[test]
fn every_frame_of_four_faulty_devices_is_accounted_for() {
    let folder = std::env::temp_dir();
    programs::run("soak", &["24", "4", "11"], &folder).expect_code(0);
}

#[test]
fn eight_sensors_at_1_khz_lose_no_sample() {
    let folder = std::env::temp_dir();
    programs::run("soak", &["eight", "10"], &folder).expect_code(0);
}
