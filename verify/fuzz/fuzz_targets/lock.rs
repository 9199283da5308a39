//! See [`motord_fuzz::lock`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::lock);
