//! The physical world, the person and the devices as bytes.
