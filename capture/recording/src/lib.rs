//! ROS 2 messages, CDR and MCAP recordings, in and out.
