//! A CAN device on an existing SocketCAN interface, `vcan` as a rule.

use ft_wire::CanFrame;
use socketcan::{CanSocket, EmbeddedFrame, ExtendedId, Id, Socket, StandardId};

use super::ServeError;

#[derive(Debug)]
pub(super) struct Vcan {
    socket: CanSocket,
    dropped: u64,
}

impl Vcan {
    pub(super) fn open(interface: &str) -> Result<Self, ServeError> {
        let failed = |source| ServeError::Can {
            interface: interface.to_owned(),
            source,
        };
        let socket = CanSocket::open(interface).map_err(failed)?;
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self { socket, dropped: 0 })
    }

    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    pub(super) fn read(&self, mut heard: impl FnMut(CanFrame)) {
        while let Ok(frame) = self.socket.read_frame() {
            let socketcan::CanFrame::Data(data) = frame else {
                continue;
            };
            let frame = match data.id() {
                Id::Standard(id) => CanFrame::standard(id.as_raw(), data.data()),
                Id::Extended(id) => CanFrame::extended(id.as_raw(), data.data()),
            };
            frame.into_iter().for_each(&mut heard);
        }
    }

    pub(super) fn write(&mut self, frame: &CanFrame) {
        let id = frame.arbitration_id();
        let id = if frame.is_extended() {
            ExtendedId::new(id).map(Id::Extended)
        } else {
            u16::try_from(id)
                .ok()
                .and_then(StandardId::new)
                .map(Id::Standard)
        };
        let sent = id
            .and_then(|id| socketcan::CanFrame::new(id, frame.payload()))
            .is_some_and(|frame| self.socket.write_frame(&frame).is_ok());
        if !sent {
            self.dropped += 1;
        }
    }
}
