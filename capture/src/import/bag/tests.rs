use super::*;

fn sized(bytes: &[u8]) -> Vec<u8> {
    let length = u32::try_from(bytes.len()).unwrap().to_le_bytes();
    [&length, bytes].concat()
}

fn header(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let field = |(name, value): &(&str, &[u8])| sized(&[name.as_bytes(), b"=", *value].concat());
    sized(&fields.iter().map(field).collect::<Vec<_>>().concat())
}

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    [header(fields), sized(data)].concat()
}

const START: &[u8] = b"#ROSBAG V2.0\n";

/// A connection of type `kind` and two wrenches on it, in a chunk.
fn chunk(compression: &[u8], kind: &[u8]) -> Vec<u8> {
    let id: &[u8] = &7_u32.to_le_bytes();
    let inner = header(&[("type", kind), ("topic", b"/w")]);
    let mut chunk = record(&[("op", &[7]), ("conn", id), ("topic", b"/w")], &inner[4..]);
    for second in [5_u32, 4] {
        let mut data = [9_u32, second, 250, 2].map(u32::to_le_bytes).concat();
        data.extend(b"ft");
        for axis in 0..6 {
            data.extend((f64::from(second) + 0.5 * f64::from(axis)).to_le_bytes());
        }
        chunk.extend(record(
            &[("op", &[2]), ("conn", id), ("time", &[0; 8])],
            &data,
        ));
    }
    record(
        &[
            ("op", &[5]),
            ("compression", compression),
            ("size", &[0; 4]),
        ],
        &chunk,
    )
}

fn bag(compression: &[u8]) -> Vec<u8> {
    let chunk = chunk(compression, b"geometry_msgs/WrenchStamped");
    [START, &record(&[("op", &[3])], &[b' '; 64]), &chunk].concat()
}

/// Wrenches of `/w`, what was seen on the way, and the number of topics.
type Read = (Vec<Stamped<[f64; 6]>>, records::Scanned, usize);

/// What is read of `bytes`.
fn read(bytes: &[u8]) -> Result<Read, String> {
    let mut samples = Samples {
        wrench: Wanted::new("/w", WRENCH_TYPE, 0),
        temperature: Wanted::new("/t", TEMPERATURE_TYPE, 0),
        imu: Wanted::new("/i", IMU_TYPE, BEFORE_RATE),
    };
    // Records that straddle what is buffered are put together.
    let mut records = Records::new(BufReader::with_capacity(7, bytes));
    let scanned = records.scan(&mut samples, &mut |_| {});
    let topics = records.topics().len();
    match scanned {
        Ok(scanned) => Ok((samples.wrench.samples, scanned, topics)),
        Err(ScanError::Format(reason)) => Err(reason),
        Err(ScanError::Io(error)) => Err(error.to_string()),
    }
}

#[test]
fn wrenches_are_read_by_their_stamps() {
    let (found, scanned, topics) = read(&bag(b"none")).unwrap();
    let stamps: Vec<_> = found.iter().map(|sample| sample.at.as_nanos()).collect();
    assert_eq!(stamps, [5_000_000_250, 4_000_000_250]);
    assert_eq!(found[1].value, [4.0, 4.5, 5.0, 5.5, 6.0, 6.5]);
    assert_eq!(
        (topics, scanned.cut_short, scanned.damaged_chunks),
        (1, false, 0)
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bag");
    std::fs::write(&path, bag(b"none")).unwrap();
    assert_eq!(scanned.sha256, crate::import::sha256(&path).unwrap());
}

#[test]
fn a_bag_that_was_cut_or_damaged_reads_as_far_as_it_goes() {
    let whole = bag(b"none");
    for cut in START.len()..whole.len() {
        let (found, scanned, _) = read(&whole[..cut]).unwrap();
        assert!(
            found.len() < 2 && scanned.cut_short | found.is_empty(),
            "{cut}"
        );
        let mut wrong = whole.clone();
        wrong[cut] ^= 0xff;
        if let Ok((found, ..)) = read(&wrong) {
            assert!(found.len() <= 2);
        }
    }
}

#[test]
fn a_damaged_chunk_costs_no_other() {
    let kind = b"geometry_msgs/WrenchStamped";
    let mut first = chunk(b"none", kind);
    let length = first.len();
    // The last message says that it is longer than the chunk.
    first[length - 70..length - 66].copy_from_slice(&[0xff, 0xff, 0, 0]);
    let both = [START, &first, &chunk(b"none", kind)].concat();
    let (found, scanned, _) = read(&both).unwrap();
    assert_eq!(
        (found.len(), scanned.damaged_chunks, scanned.cut_short),
        (3, 1, false)
    );
}

#[test]
fn a_topic_of_another_type_is_no_wrench_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.bag"), folder.path().join("a.mcap"));
    std::fs::write(
        &path,
        [START, &chunk(b"none", b"geometry_msgs/TwistStamped")].concat(),
    )
    .unwrap();
    let topics = |temperature| BagTopics {
        wrench: "/w",
        temperature,
        imu: "/i",
    };
    let text = import_bag(&path, &topics("/t"), &out, false, &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("no usable geometry_msgs/WrenchStamped on /w")
            && text.contains("/w (geometry_msgs/TwistStamped)"),
        "{text}"
    );
    assert!(!out.exists());
    // A temperature of another type is told, and stops nothing.
    std::fs::write(&path, bag(b"none")).unwrap();
    let report = import_bag(&path, &topics("/w"), &out, false, &mut |_, _| {}).unwrap();
    assert!(
        report
            .to_string()
            .contains("not read: /w (geometry_msgs/WrenchStamped) is of another type"),
        "{report}"
    );
}

/// An `Imu` of the rates 1, 2, 3 rad/s, whose covariance begins with `covariance`.
fn imu(second: u32, covariance: f64) -> Vec<u8> {
    let mut data = [9_u32, second, 250, 2].map(u32::to_le_bytes).concat();
    data.extend(b"ft");
    // Orientation and its covariance, which say nothing.
    let mut numbers = vec![f64::NAN; 13];
    numbers.extend([1.0, 2.0, 3.0, covariance]);
    numbers.extend([0.0; 8 + 3 + 9]);
    data.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    data
}

#[test]
fn the_angular_rate_of_an_inertial_unit_is_read_where_it_is_measured() {
    let mut wanted: Wanted<'_, 4> = Wanted::new("/i", IMU_TYPE, BEFORE_RATE);
    for (second, covariance) in [(7, 0.0), (6, 1e-4), (8, -1.0)] {
        wanted.take(&imu(second, covariance));
    }
    wanted.take(&imu(9, 0.0)[..100]);
    let rates = wanted.measured();
    let stamps: Vec<_> = rates.iter().map(|rate| rate.at.as_nanos()).collect();
    assert_eq!(stamps, [6_000_000_250, 7_000_000_250]);
    assert_eq!(rates[0].value, [1.0, 2.0, 3.0]);
    assert_eq!(wanted.left_out, 2);
}

#[test]
fn packed_chunks_and_other_files_are_refused_with_what_to_do() {
    let packed = read(&bag(b"lz4")).unwrap_err();
    assert!(
        packed.contains("lz4") && packed.contains("rosbag decompress"),
        "{packed}"
    );
    assert!(read(b"#ROSBAG V1.2").unwrap_err().contains("format 2.0"));
    assert!(read(b"").unwrap_err().contains("format 2.0"));
}

#[test]
fn a_stamp_of_1970_is_left_out_and_counted() {
    let mut wanted = Wanted::<1>::new("/w", WRENCH_TYPE, 0);
    for second in [1_700_000_000_u32, 0, 1_700_000_001] {
        let mut data = [9, second, 0, 0].map(u32::to_le_bytes).concat();
        data.extend(1.0_f64.to_le_bytes());
        wanted.take(&data);
    }
    wanted.sort();
    let seconds = |sample: &Stamped<[f64; 1]>| sample.at.as_nanos() / 1_000_000_000;
    let stamps: Vec<_> = wanted.samples.iter().map(seconds).collect();
    assert_eq!(stamps, [1_700_000_000, 1_700_000_001]);
    assert_eq!(wanted.left_out, 1);
}

#[test]
fn wrenches_by_a_clock_that_was_set_back_are_left_out_and_counted() {
    let mut wanted = Wanted::<1>::new("/w", WRENCH_TYPE, 0);
    for k in 0..1_000_u32 {
        let ms = if k < 600 { 10 * k } else { 10 * k - 3_005 };
        let (second, nanos) = (1_700_000_000 + ms / 1_000, ms % 1_000 * 1_000_000);
        let mut data = [k, second, nanos, 0].map(u32::to_le_bytes).concat();
        data.extend(f64::from(k).to_le_bytes());
        wanted.take(&data);
    }
    wanted.sort();
    let numbers: Vec<f64> = wanted
        .samples
        .iter()
        .map(|sample| sample.value[0])
        .collect();
    assert_eq!(numbers, (0..600).map(f64::from).collect::<Vec<_>>());
    assert_eq!((wanted.left_out, wanted.set_back), (400, 400));
}
