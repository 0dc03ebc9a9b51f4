//! Poses as 4x4 matrices in Kalibr's YAML and in JSON.

use std::path::Path;

use ft_recording::Pose7;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};

use super::ImportError;

/// The matrix `key` below the section `section:` of a YAML file, however its rows are written.
///
/// # Errors
/// It is not there, has not 16 numbers, or is no pose.
pub fn from_yaml(text: &str, section: &str, key: &str, path: &Path) -> Result<Pose7, ImportError> {
    let text = plain(text);
    let body =
        section_of(&text, section).ok_or_else(|| wrong(path, &format!("no section {section}")))?;
    let start = body
        .match_indices(key)
        .find_map(|(at, _)| {
            let before = body[..at].chars().next_back();
            let begins = before.is_none_or(|c| c.is_whitespace() || c == '{' || c == ',');
            let behind = body[at + key.len()..].trim_start_matches(' ');
            let value = behind.strip_prefix(':').filter(|_| begins)?;
            Some(body.len() - value.len())
        })
        .ok_or_else(|| wrong(path, &format!("no {key} in {section}")))?;
    let mut numbers = Vec::new();
    let separators = |c: char| c.is_whitespace() || matches!(c, '[' | ']' | ',');
    for word in body[start..].split(separators) {
        // Block lists put a dash before each element.
        if word.is_empty() || word == "-" {
            continue;
        }
        let Ok(number) = word.parse::<f64>() else {
            break;
        };
        numbers.push(number);
        if numbers.len() == 16 {
            break;
        }
    }
    pose(&numbers, key, path)
}

/// Without comments and quotes. Of what is quoted, keys and numbers stay: other text may look like anything.
fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        let mut rest = line;
        let mut before = ' ';
        while let Some(c) = rest.chars().next() {
            let begins = before.is_whitespace();
            if c == '#' && begins {
                break;
            }
            let quoted = match c {
                '"' | '\'' if begins || matches!(before, '[' | '{' | ',' | ':' | '-') => {
                    rest[1..].split_once(c)
                }
                _ => None,
            };
            let Some((inner, behind)) = quoted else {
                out.push(c);
                (before, rest) = (c, &rest[c.len_utf8()..]);
                continue;
            };
            if behind.trim_start_matches(' ').starts_with(':') || inner.parse::<f64>().is_ok() {
                out.push_str(inner);
            }
            (before, rest) = (c, behind);
        }
        if !out.ends_with('\n') {
            out.push('\n');
        }
    }
    out
}

/// The lines below `section:` up to the next line that begins in the first column.
fn section_of<'a>(text: &'a str, section: &str) -> Option<&'a str> {
    let value = |line: &str| {
        let behind = line.strip_prefix(section)?.trim_start_matches(' ');
        Some(line.len() - behind.strip_prefix(':')?.len())
    };
    let mut at = 0;
    let mut start = None;
    for line in text.split_inclusive('\n') {
        let begins = !line.starts_with([' ', '\t', '#', '\n', '\r', '-']);
        match start {
            None => start = value(line).map(|behind| at + behind),
            Some(start) if begins => return text.get(start..at),
            _ => {}
        }
        at += line.len();
    }
    text.get(start?..)
}

/// The 4x4 matrix at `pointer` of a JSON file.
///
/// # Errors
/// It is not there, has not 16 numbers, or is no pose.
pub fn from_json(text: &str, pointer: &str, path: &Path) -> Result<Pose7, ImportError> {
    let value: serde_json::Value =
        serde_json::from_str(text).map_err(|error| wrong(path, &error.to_string()))?;
    let matrix = value
        .pointer(pointer)
        .ok_or_else(|| wrong(path, &format!("no {pointer}")))?;
    let mut numbers = Vec::new();
    let rows = matrix.as_array().into_iter().flatten();
    for row in rows {
        match row.as_array() {
            Some(row) => numbers.extend(row.iter().filter_map(serde_json::Value::as_f64)),
            None => numbers.extend(row.as_f64()),
        }
    }
    pose(&numbers, pointer, path)
}

fn pose(numbers: &[f64], key: &str, path: &Path) -> Result<Pose7, ImportError> {
    let &[a, b, c, x, d, e, f, y, g, h, i, z, p, q, r, one] = numbers else {
        return Err(wrong(
            path,
            &format!("{key} has {} numbers, expected 16", numbers.len()),
        ));
    };
    let turn = Matrix3::new(a, b, c, d, e, f, g, h, i);
    let skewed = (turn * turn.transpose() - Matrix3::identity()).norm();
    let determinant = turn.determinant();
    let last = [p, q, r, one - 1.0].iter().map(|v| v.abs()).sum::<f64>();
    let why = if skewed.is_nan() || skewed >= 1e-3 {
        format!("its rotation is off by {skewed:.2e}")
    } else if determinant <= 0.0 {
        format!("its rotation mirrors (determinant {determinant:.3})")
    } else if last.is_nan() || last >= 1e-9 {
        format!("its last row is {p} {q} {r} {one}, expected 0 0 0 1")
    } else if ![x, y, z].iter().all(|v| v.is_finite()) {
        format!("its position is {x} {y} {z}")
    } else {
        String::new()
    };
    if !why.is_empty() {
        return Err(wrong(path, &format!("{key} is no pose: {why}")));
    }
    let turn = Rotation3::from_matrix_eps(&turn, 1e-12, 100, Rotation3::identity());
    let q = UnitQuaternion::from_rotation_matrix(&turn).coords;
    Ok(Pose7 {
        position: [x, y, z],
        quaternion: [q.x, q.y, q.z, q.w],
    })
}

fn wrong(path: &Path, reason: &str) -> ImportError {
    ImportError::Content {
        path: path.to_owned(),
        reason: reason.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: &str = "cam1:\n  T_cam_imu: [[1,0,0,9],[0,1,0,9],[0,0,1,9],[0,0,0,1]]\ncam2:\n  T_cam_imu:\n  - [0.0, -1.0, 0.0, 1.0e-1]\n  \
                        - [1.0, 0.0, 0.0, -2]\n  - [0.0, 0.0, 1.0, 3]\n  - [0.0, 0.0, 0.0, 1.0]\n  timeshift_cam_imu: 0.5\n";

    #[test]
    fn a_matrix_of_rows_is_read_from_its_own_section() {
        let pose = from_yaml(ROWS, "cam2", "T_cam_imu", Path::new("a.yaml")).unwrap();
        assert_eq!(pose.position, [0.1, -2.0, 3.0]);
        let [x, y, _] = pose.rotate([1.0, 0.0, 0.0]);
        assert!(x.abs() < 1e-9 && (y - 1.0).abs() < 1e-9);
    }

    #[test]
    fn comments_and_quotes_are_understood() {
        let text = "%YAML:1.0\n---\n# cam2: of last year, T_cam_imu: [[9]]\n\"cam2\" :  # the glasses' camera\n  # T_cam_imu: [[0, 0, 0, 7]]\n  \
                    note: \"T_cam_imu: not here # nor here\"\n  hint: it's T_cam_imu that is wanted\n  'T_cam_imu' :   # m\n  - [1.0, 0, 0, \"0.1\"]   # x\n\
                    # a line between\n  - [0, 1.0, 0, '-2']  # y: 3\n\n  - [0, 0, 1.0,\n     3 ] # z\n  - [0, 0, 0, 1]\ncam3: {}\n";
        let pose = from_yaml(text, "cam2", "T_cam_imu", Path::new("a.yaml")).unwrap();
        assert_eq!(pose.position, [0.1, -2.0, 3.0]);
        // Nothing of what is quoted or commented out is a section or a key.
        let of = |section, key| from_yaml(text, section, key, Path::new("a.yaml")).unwrap_err();
        assert_eq!(of("hint", "T").to_string(), "a.yaml: no section hint");
        assert_eq!(of("cam2", "T_x").to_string(), "a.yaml: no T_x in cam2");
        let flow = "{}# x\ncam2: {'T': [[1,0,0,4],[0,1,0,5],[0,0,1,6],[0,0,0,1]], \"b\": 'x'}\n";
        let pose = from_yaml(flow, "cam2", "T", Path::new("a.yaml")).unwrap();
        assert_eq!(pose.position, [4.0, 5.0, 6.0]);
    }

    #[test]
    fn nested_block_lists_are_read_too() {
        let text = "imu0:\n  T_i_s:\n  - - 1.0\n    - 0.0\n    - 0.0\n    - 0.5\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n";
        let pose = from_yaml(text, "imu0", "T_i_s", Path::new("a.yaml")).unwrap();
        assert_eq!(pose.position, [0.5, 0.0, 0.0]);
    }

    #[test]
    fn what_is_missing_or_no_pose_is_named() {
        let of = |section, key| {
            from_yaml(ROWS, section, key, Path::new("a.yaml"))
                .unwrap_err()
                .to_string()
        };
        assert_eq!(of("cam3", "T_cam_imu"), "a.yaml: no section cam3");
        assert_eq!(of("cam2", "T_i_b"), "a.yaml: no T_i_b in cam2");
        let short = from_yaml("a:\n  T: [1, 2]\n", "a", "T", Path::new("a.yaml")).unwrap_err();
        assert_eq!(short.to_string(), "a.yaml: T has 2 numbers, expected 16");
        let json = "{\"N\": {\"T\": [[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]}}";
        let message = from_json(json, "/N/T", Path::new("a.json"))
            .unwrap_err()
            .to_string();
        assert!(message.contains("is no pose"), "{message}");
        assert!(message.contains("rotation is off by"), "{message}");
        for (rows, wanted) in [
            (
                "[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]",
                "mirrors (determinant -1.000)",
            ),
            (
                "[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]",
                "its last row is 0 0 0 2, expected 0 0 0 1",
            ),
        ] {
            let json = format!("{{\"N\": {{\"T\": [{rows}]}}}}");
            let error = from_json(&json, "/N/T", Path::new("a.json")).unwrap_err();
            assert!(error.to_string().contains(wanted), "{error}");
        }
    }
}
