//! See [`motord_fuzz::disarmed`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::disarmed);
