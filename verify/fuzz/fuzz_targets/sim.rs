//! See [`motord_fuzz::sim`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::sim);
