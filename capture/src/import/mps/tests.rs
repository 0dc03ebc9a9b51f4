use super::*;

fn read(text: &str, min_quality: f64) -> Result<Trajectory, ImportError> {
    let table = Table::from_bytes(text.as_bytes(), Path::new("closed_loop_trajectory.csv"))?;
    Trajectory::from_table(&table, min_quality)
}

const HEADER: &str = "quality_score,tracking_timestamp_us,utc_timestamp_ns,qw_world_device,qx_world_device,qy_world_device,\
                      qz_world_device,tx_world_device,ty_world_device,tz_world_device,gravity_x_world,gravity_y_world,gravity_z_world\n";

#[test]
fn rows_that_cannot_be_used_are_left_out_and_counted() {
    let text = format!(
        "{HEADER}0.2,5,-1,1,0,0,0,0,0,0,0,0,-9.81\n1,10,7,1,0,0,0,0,0,0,0,0,-9.81\n1,10,7,1,0,0,0,0,0,0,0,0,-9.81\n\
         1,11,7,0,0,0,0,0,0,0,0,0,-9.81\n1,12,-1,1,0,0,0,1,0,0,0,0,-9.81\n"
    );
    let trajectory = read(&text, 0.5).unwrap();
    assert_eq!(trajectory.poses.len(), 2);
    assert_eq!(trajectory.poses[0].device_ns, 10_000);
    assert_eq!(
        (trajectory.poses[0].utc_ns, trajectory.poses[1].utc_ns),
        (Some(7), None)
    );
    let counts = trajectory.counts;
    assert_eq!(
        (
            counts.low_quality,
            counts.not_later,
            counts.no_pose,
            counts.without_utc
        ),
        (1, 1, 1, 2)
    );
}

#[test]
fn rows_with_empty_fields_are_left_out_one_by_one() {
    let row = |t: &str, w: &str, g: &str| format!("1,{t},-1,{w},0,0,0,0,2,0,0,{g},0\n");
    let text = format!(
        "{HEADER}{}{}{}{}{}{}",
        row("1", "1", "-9.81"),
        row("", "1", "-9.81"),
        row("nan", "1", "-9.81"),
        row("3", "", "-9.81"),
        row("4", "1", ""),
        row("9e18", "1", "-9.81"),
    );
    let trajectory = read(&text, 0.0).unwrap();
    assert_eq!(trajectory.poses.len(), 2);
    let counts = trajectory.counts;
    assert_eq!((counts.no_stamp, counts.no_pose, counts.rows), (3, 1, 6));
    // An empty gravity does not hide what the other rows say of it.
    assert!((counts.turned_deg - 90.0).abs() < 1e-9);
}

#[test]
fn a_world_with_y_up_is_turned_to_z_up() {
    let row = |t: i32| format!("1,{t},-1,1,0,0,0,0,2,0,0,-9.81,0\n");
    let trajectory = read(&format!("{HEADER}{}{}", row(1), row(2)), 0.0).unwrap();
    let [x, y, z] = trajectory.poses[0].pose.position;
    assert!(
        x.abs() < 1e-12 && y.abs() < 1e-12 && (z - 2.0).abs() < 1e-12,
        "{x} {y} {z}"
    );
    assert!((trajectory.counts.turned_deg - 90.0).abs() < 1e-9);
}

#[test]
fn a_world_upside_down_is_turned_over() {
    let row = |t: i32| format!("1,{t},-1,1,0,0,0,0,0,2,0,0,9.81\n");
    let trajectory = read(&format!("{HEADER}{}{}", row(1), row(2)), 0.0).unwrap();
    assert!((trajectory.poses[0].pose.position[2] + 2.0).abs() < 1e-12);
}

#[test]
fn poses_of_another_world_are_left_out() {
    let header = format!("graph_uid,{HEADER}");
    let row = |uid: &str, t: i32| format!("{uid},1,{t},-1,1,0,0,0,0,2,0,0,0,-9.81\n");
    let text = format!("{header}{}{}{}", row("a", 1), row("b", 2), row("b", 3));
    let trajectory = read(&text, 0.0).unwrap();
    assert_eq!(trajectory.poses.len(), 2);
    assert_eq!(trajectory.counts.other_world, 1);
}

#[test]
fn columns_in_other_units_are_refused() {
    let rows = |step: i64, metre: f64| {
        let row = |k: i64| {
            format!(
                "1,{},-1,1,0,0,0,{},0,0,0,0,-9.81\n",
                k * step,
                k as f64 * metre
            )
        };
        (1..50).map(row).collect::<String>()
    };
    // 1 kHz, 0.5 m/s.
    assert!(read(&format!("{HEADER}{}", rows(1_000, 5e-4)), 0.0).is_ok());
    let refusal = |step, metre| {
        let text = format!("{HEADER}{}", rows(step, metre));
        read(&text, 0.0).unwrap_err().to_string()
    };
    assert!(refusal(1_000_000, 5e-4).contains("must be in us"));
    assert!(refusal(1, 5e-4).contains("must be in us"));
    assert!(refusal(1_000, 0.5).contains("must be in m"));
}

#[test]
fn a_quaternion_of_another_length_is_named() {
    for (length, wanted) in [
        ("0", "has the length 0.000"),
        ("100", "has the length 100.000"),
    ] {
        let text = format!("{HEADER}1,1,-1,{length},0,0,0,0,0,0,0,0,-9.81\n");
        let message = read(&text, 0.0).unwrap_err().to_string();
        assert!(message.contains(wanted), "{message}");
    }
}

#[test]
fn a_trajectory_without_a_usable_pose_is_refused() {
    let text = format!("{HEADER}0.2,5,-1,1,0,0,0,0,0,0,0,0,-9.81\n");
    let message = read(&text, 0.5).unwrap_err().to_string();
    assert!(
        message.contains("0 of 1 rows are usable poses"),
        "{message}"
    );
}
