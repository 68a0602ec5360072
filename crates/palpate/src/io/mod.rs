//! Files: one per format. The only module that touches the file system.
