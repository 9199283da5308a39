//! See [`motord_fuzz::commands`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::commands);
