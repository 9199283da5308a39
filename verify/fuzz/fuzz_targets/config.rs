//! See [`motord_fuzz::config`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::config);
