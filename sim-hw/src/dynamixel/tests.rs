use super::*;
use crate::random::Stream;
use crate::scenario::Scenario;

fn scene() -> Scene {
    let mut scene = Scene::new(&Scenario::builtin("wood_door").unwrap(), 1, None).unwrap();
    scene.advance_to(0.1);
    scene
}

fn servo() -> Dynamixel {
    Dynamixel::new(&GripperSpec::default(), Random::new(1, Stream::Gripper))
}

fn asked(servo: &mut Dynamixel, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    servo.receive(100_000_000, &Chunk::new(bytes).unwrap(), &scene(), &mut out);
    out.iter()
        .flat_map(|(_, chunk)| chunk.as_slice().to_vec())
        .collect()
}

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

/// An instruction with its CRC, not stuffed.
fn instruction(id: u8, code: u8, parameters: &[u8]) -> Vec<u8> {
    let mut packet = vec![0xFF, 0xFF, 0xFD, 0x00, id];
    packet.extend((parameters.len() as u16 + 3).to_le_bytes());
    packet.push(code);
    packet.extend(parameters);
    let check = crate::crc::dynamixel(&packet);
    packet.extend(check.to_le_bytes());
    packet
}

#[test]
fn the_manuals_status_packets_come_out() {
    // emanual, protocol 2.0: present position 166 of id 1.
    assert_eq!(
        packet::status(1, Ok(vec![0xA6, 0, 0, 0])),
        bytes("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
    );
    assert_eq!(
        packet::status(1, Ok(vec![0x06, 0x04, 0x26])),
        bytes("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
    );
    let ten = vec![0x9C, 0xFF, 0x05, 0, 0, 0, 0, 0x08, 0, 0];
    assert_eq!(
        packet::status(1, Ok(ten)),
        bytes("FF FF FD 00 01 0E 00 55 00 9C FF 05 00 00 00 00 08 00 00 05 09")
    );
}

#[test]
fn the_manuals_instructions_are_heard() {
    let mut servo = servo();
    let ping = asked(&mut servo, &bytes("FF FF FD 00 01 03 00 01 19 4E"));
    assert_eq!(ping[..9], bytes("FF FF FD 00 01 07 00 55 00"));
    let position = asked(
        &mut servo,
        &bytes("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    );
    assert_eq!(position.len(), 15);
    let counts = i32::from_le_bytes([position[9], position[10], position[11], position[12]]);
    let open = jaw::shaft_degrees(0.085) * 4096.0 / 360.0;
    assert!((f64::from(counts) - open).abs() < 10.0, "{counts} {open}");
    let ten = asked(
        &mut servo,
        &bytes("FF FF FD 00 01 07 00 02 7E 00 0A 00 36 F9"),
    );
    assert_eq!((ten.len(), ten[5]), (21, 0x0E));
    let off = asked(&mut servo, &bytes("FF FF FD 00 01 06 00 03 40 00 00 DE E6"));
    assert_eq!(off[7..9], [0x55, 0]);
}

#[test]
fn a_stuffed_write_is_unstuffed() {
    let mut servo = servo();
    // Goal position 0x00FDFFFF, as stuffed by the maker's rule.
    let answer = asked(
        &mut servo,
        &bytes("FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7"),
    );
    assert_eq!(answer[8], 0);
    let read = asked(&mut servo, &instruction(1, READ, &[116, 0, 4, 0]));
    assert_eq!(
        read[9..14],
        [0xFF, 0xFF, 0xFD, 0xFD, 0x00],
        "and stuffed on the way back"
    );
}

#[test]
fn faults_are_answered_with_their_number() {
    let mut servo = servo();
    let fault = |servo: &mut Dynamixel, packet: &[u8]| asked(servo, packet)[8];
    assert_eq!(
        fault(&mut servo, &instruction(1, 0x55, &[])),
        Fault::Instruction as u8
    );
    let mut broken = instruction(1, READ, &[132, 0, 4, 0]);
    broken[8] ^= 1;
    assert_eq!(fault(&mut servo, &broken), Fault::Crc as u8);
    assert_eq!(
        fault(&mut servo, &instruction(1, READ, &[200, 0, 4, 0])),
        Fault::DataRange as u8
    );
    assert_eq!(
        fault(&mut servo, &instruction(1, READ, &[132, 0])),
        Fault::DataLength as u8
    );
    assert_eq!(
        fault(&mut servo, &instruction(1, WRITE, &[132, 0, 1, 2, 3, 4])),
        Fault::Access as u8
    );
    assert_eq!(
        fault(&mut servo, &instruction(1, WRITE, &[9, 0, 255])),
        Fault::DataRange as u8
    );
}

#[test]
fn what_is_kept_over_a_reboot_is_locked_while_the_torque_is_on() {
    let mut servo = servo();
    asked(&mut servo, &instruction(1, WRITE, &[64, 0, 1]));
    assert_eq!(
        asked(&mut servo, &instruction(1, WRITE, &[9, 0, 0]))[8],
        Fault::Access as u8
    );
    asked(&mut servo, &instruction(1, WRITE, &[64, 0, 0]));
    assert_eq!(asked(&mut servo, &instruction(1, WRITE, &[9, 0, 0]))[8], 0);
    assert_eq!(servo.registers.return_delay_ns(), 0);
    assert_eq!(asked(&mut servo, &instruction(1, WRITE, &[8, 0, 3]))[8], 0);
    assert_eq!(servo.line_rate(), Some(1_000_000));
}

#[test]
fn only_its_own_id_and_broadcasts_are_heard() {
    let mut servo = servo();
    assert!(asked(&mut servo, &instruction(2, PING, &[])).is_empty());
    assert_eq!(
        asked(&mut servo, &instruction(BROADCAST, PING, &[])).len(),
        14
    );
    assert!(asked(&mut servo, &instruction(BROADCAST, WRITE, &[65, 0, 1])).is_empty());
    assert_eq!(
        asked(
            &mut servo,
            &instruction(BROADCAST, SYNC_READ, &[132, 0, 4, 0, 3, 1])
        )
        .len(),
        15
    );
    assert!(
        asked(
            &mut servo,
            &instruction(BROADCAST, SYNC_READ, &[132, 0, 4, 0, 3, 4])
        )
        .is_empty()
    );
}

#[test]
fn a_packet_in_pieces_among_noise_is_one_packet() {
    let mut servo = servo();
    let mut stream = vec![0x00, 0xFF, 0xFF, 0xFF];
    stream.extend(instruction(1, READ, &[132, 0, 4, 0]));
    let mut answered = Vec::new();
    for byte in stream {
        answered.extend(asked(&mut servo, &[byte]));
    }
    assert_eq!(answered.len(), 15);
}
