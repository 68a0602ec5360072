//! The methods, top to bottom: one frame and some touches in, a closed mesh out.
