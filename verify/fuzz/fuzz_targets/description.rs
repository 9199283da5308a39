//! See [`motord_fuzz::description`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::description);
