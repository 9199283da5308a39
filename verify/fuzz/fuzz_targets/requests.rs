//! See [`motord_fuzz::requests`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::requests);
