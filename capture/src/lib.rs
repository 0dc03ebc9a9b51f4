//! Time-synchronised capture service: records, publishes and shows what the devices say.
