//! The sensor's bias, from what a recording without free air has.

use std::collections::BTreeMap;

use ft_recording::{Estimate, Recording};

use super::{COM_M, GRAVITY, MASS_KG};

/// Bias from stretches of 5 s in which the wrench without the tool's weight stays, near the first of them; and their length, s.
pub(super) fn quiet_bias(recording: &Recording) -> (Option<Estimate<[f64; 6]>>, f64) {
    const STRETCH_S: f64 = 5.0;
    let world_from_tracked = &recording.pose.samples;
    let device_from_sensor = recording
        .aria_device_from_tcp
        .then(&recording.tcp_from_ft_sensor);
    let Some(start) = recording.wrench.first().map(|sample| sample.at) else {
        return (None, 0.0);
    };
    // By number: a stamp that is far off must not ask for memory.
    let mut stretches: BTreeMap<usize, Vec<[f64; 6]>> = BTreeMap::new();
    for sample in &recording.wrench {
        let after = world_from_tracked.partition_point(|pose| pose.at <= sample.at);
        let Some(pose) = after.checked_sub(1).and_then(|k| world_from_tracked.get(k)) else {
            continue;
        };
        let rotation = pose.value.then(&device_from_sensor).inverse();
        let [gx, gy, gz] = rotation.rotate([0.0, 0.0, -GRAVITY]).map(|g| MASS_KG * g);
        let [cx, cy, cz] = COM_M;
        let own = [
            gx,
            gy,
            gz,
            cy * gz - cz * gy,
            cz * gx - cx * gz,
            cx * gy - cy * gx,
        ];
        let index = (sample.at.seconds_since(start) / STRETCH_S) as usize;
        let stretch = stretches.entry(index).or_default();
        stretch.push(core::array::from_fn(|k| sample.value[k] - own[k]));
    }
    let judged = stretches
        .values()
        .filter(|rest| rest.len() > 20)
        .map(|rest| {
            let n = rest.len() as f64;
            let mean: [f64; 6] =
                core::array::from_fn(|k| rest.iter().map(|r| r[k]).sum::<f64>() / n);
            let std: [f64; 6] = core::array::from_fn(|k| {
                (rest.iter().map(|r| (r[k] - mean[k]).powi(2)).sum::<f64>() / n).sqrt()
            });
            (mean, std)
        });
    let is_quiet =
        |std: &[f64; 6]| std[..3].iter().all(|s| *s < 0.3) && std[3..].iter().all(|s| *s < 0.03);
    let mut near: Vec<[f64; 6]> = Vec::new();
    for (mean, _) in judged.filter(|(_, std)| is_quiet(std)) {
        let first = *near.first().unwrap_or(&mean);
        if (0..3).all(|k| (mean[k] - first[k]).abs() < 0.7) {
            near.push(mean);
        }
    }
    let n = near.len() as f64;
    if near.is_empty() {
        return (None, 0.0);
    }
    let value: [f64; 6] = core::array::from_fn(|k| near.iter().map(|m| m[k]).sum::<f64>() / n);
    let std = core::array::from_fn(|k| {
        let spread = (near.iter().map(|m| (m[k] - value[k]).powi(2)).sum::<f64>() / n).sqrt();
        spread.max(if k < 3 { 0.1 } else { 0.005 })
    });
    (Some(Estimate { value, std }), n * STRETCH_S)
}
