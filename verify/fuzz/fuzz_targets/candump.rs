//! See [`motord_fuzz::candump`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::candump);
