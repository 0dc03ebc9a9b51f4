//! The drivers on a real kernel with virtual devices: `cargo test -p ft-tests --test lab`.
//!
//! One guest runs all cases (`tests/lab`) and each has a line here. `FT_LAB_ONLY=can,hid` runs those with one of these in
//! their names.

use ft_tests::lab;

macro_rules! cases {
    ($($name:ident)*) => {
        $(#[test]
        fn $name() {
            if is_wanted(stringify!($name)) {
                lab::holds(stringify!($name));
            }
        })*
        const NAMES: &[&str] = &[$(stringify!($name)),*];
    };
}

fn is_wanted(name: &str) -> bool {
    std::env::var("FT_LAB_ONLY")
        .map_or(true, |only| only.split(',').any(|part| name.contains(part)))
}

cases! {
    can_robotous
    can_optoforce
    can_ati
    can_flooded_bus_costs_no_sample
    can_frames_without_room_are_counted
    can_error_frames_are_counted_by_class
    can_bus_off_ends_the_link
    can_interface_that_is_down_says_so
    can_nobody_acknowledges
    can_sensors_read_by_a_strangers_program
    acm_bota
    acm_robotous
    acm_optoforce
    acm_kunwei
    acm_leptrino
    acm_encoders_agree
    acm_pose_stream
    acm_port_is_ours_alone
    acm_unplugged_is_gone
    acm_two_of_a_kind_are_told_apart
    hid_slider_is_a_width
    hid_dial_sums_its_steps
    hid_unplugged_is_gone
    hid_device_is_ours_alone
    hid_report_that_is_too_long_is_told
    hid_two_of_a_kind_are_told_apart
    udev_rules_open_every_serial_identity
    udev_rules_open_candlelights
    udev_names_stay_with_the_serial_number
    udev_leaves_other_devices_alone
    udev_line_that_devices_prints_works
    service_finds_a_replugged_sensor_under_another_name
    service_comes_back_after_bus_off_and_a_downed_bus
    service_records_on_after_a_candlelight_was_replugged
    candle_is_ours_alone
    candle_two_of_a_kind_are_told_apart
    candle_without_a_name_stays_the_one_that_was_found
    candle_comes_at_the_bit_rate_of_its_sensor
    candle_weighs_for_long
    candle_at_a_wrong_bit_rate
    candle_unplugged_is_gone
    candle_under_linuxs_own_driver
    network_that_delays_loses_and_reorders_costs_no_sample
}

#[test]
fn no_case_of_the_guest_is_without_a_line_here() {
    for name in lab::verdicts()
        .into_iter()
        .flat_map(|verdicts| verdicts.keys())
    {
        assert!(NAMES.contains(&name.as_str()), "{name}");
    }
}
