//! Who may come in: a listener that limits connections, and closes those that never say what they want.

use std::collections::HashMap;
use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::time::Sleep;

use super::refusals::{Refusals, Why};

/// Connections at one time, of everybody and of one address.
const MOST: usize = 128;
const MOST_OF_ONE: usize = 64;
/// How long a connection may live that is no viewer: pages and commands need far less.
const VISIT: Duration = Duration::from_secs(10);
/// What the system may hold for a viewer that does not read, bytes.
const SEND_BUFFER: u32 = 64 * 1024;

/// A listener with limits.
#[derive(Debug)]
pub(crate) struct Door {
    listener: TcpListener,
    inside: Inside,
    refusals: Arc<Refusals>,
}

/// Connections by address.
#[derive(Clone, Debug, Default)]
struct Inside(Arc<Mutex<HashMap<IpAddr, usize>>>);

impl Door {
    /// Opens the port.
    pub(crate) fn open(address: SocketAddr, refusals: Arc<Refusals>) -> io::Result<Self> {
        let socket = match address {
            SocketAddr::V4(_) => TcpSocket::new_v4()?,
            SocketAddr::V6(_) => TcpSocket::new_v6()?,
        };
        socket.set_reuseaddr(true)?;
        // Accepted connections inherit it.
        socket.set_send_buffer_size(SEND_BUFFER)?;
        socket.bind(address)?;
        Ok(Self {
            listener: socket.listen(256)?,
            inside: Inside::default(),
            refusals,
        })
    }
}

impl Inside {
    fn enter(&self, address: IpAddr) -> Option<Place> {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let of_one = counts.get(&address).copied().unwrap_or(0);
        if of_one >= MOST_OF_ONE || counts.values().sum::<usize>() >= MOST {
            return None;
        }
        *counts.entry(address).or_default() += 1;
        Some(Place {
            address,
            inside: self.clone(),
        })
    }
}

/// A place inside, given back when it is dropped.
#[derive(Debug)]
struct Place {
    address: IpAddr,
    inside: Inside,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut counts = self.inside.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

impl Listener for Door {
    type Io = Visit;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Visit, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok((stream, address)) => match self.inside.enter(address.ip()) {
                    Some(place) => {
                        // A page with a delay of 40 ms is still a page.
                        let _ = stream.set_nodelay(true);
                        return (Visit::new(stream, place), address);
                    }
                    None => self.refusals.add(Why::TooMany, address.ip()),
                },
                // No file descriptor is free, or the visitor left: the others have to leave first.
                Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// One connection, which ends by itself unless it becomes a viewer's.
#[derive(Debug)]
pub(crate) struct Visit {
    stream: TcpStream,
    over: Pin<Box<Sleep>>,
    stays: Arc<AtomicBool>,
    _place: Place,
}

impl Visit {
    fn new(stream: TcpStream, place: Place) -> Self {
        Self {
            stream,
            over: Box::pin(tokio::time::sleep(VISIT)),
            stays: Arc::default(),
            _place: place,
        }
    }

    fn is_over(&mut self, context: &mut Context<'_>) -> bool {
        !self.stays.load(Ordering::Relaxed) && self.over.as_mut().poll(context).is_ready()
    }
}

/// What a handler knows of its connection.
#[derive(Clone, Debug)]
pub(crate) struct Visitor {
    /// Where it comes from.
    pub(crate) address: SocketAddr,
    stays: Arc<AtomicBool>,
}

impl Visitor {
    /// It is a viewer: its connection may live as long as it reads.
    pub(crate) fn stay(&self) {
        self.stays.store(true, Ordering::Relaxed);
    }
}

impl Connected<IncomingStream<'_, Door>> for Visitor {
    fn connect_info(stream: IncomingStream<'_, Door>) -> Self {
        Self {
            address: *stream.remote_addr(),
            stays: Arc::clone(&stream.io().stays),
        }
    }
}

fn timed_out() -> io::Error {
    io::Error::new(io::ErrorKind::TimedOut, "the visit is over")
}

impl AsyncRead for Visit {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.is_over(context) {
            return Poll::Ready(Err(timed_out()));
        }
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Visit {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        if self.is_over(context) {
            return Poll::Ready(Err(timed_out()));
        }
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_limited_and_given_back() {
        let inside = Inside::default();
        let (one, other) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let mut places: Vec<_> = (0..MOST_OF_ONE).map_while(|_| inside.enter(one)).collect();
        assert_eq!(places.len(), MOST_OF_ONE);
        assert!(
            inside.enter(one).is_none(),
            "one address has taken its share"
        );
        assert!(inside.enter(other).is_some(), "the others have not");
        places.pop();
        assert!(inside.enter(one).is_some());
    }
}
