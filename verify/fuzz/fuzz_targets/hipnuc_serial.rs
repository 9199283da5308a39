//! See [`motord_fuzz::hipnuc_serial`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::hipnuc_serial);
