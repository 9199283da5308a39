//! See [`motord_fuzz::drive`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::drive);
