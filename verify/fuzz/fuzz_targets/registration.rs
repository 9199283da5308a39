//! See [`motord_fuzz::registration`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::registration);
