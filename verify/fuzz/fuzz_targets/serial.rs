//! See [`motord_fuzz::serial`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::serial);
