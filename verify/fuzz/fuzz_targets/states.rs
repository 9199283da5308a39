//! See [`motord_fuzz::states`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::states);
