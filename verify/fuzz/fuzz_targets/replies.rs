//! See [`motord_fuzz::replies`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::replies);
