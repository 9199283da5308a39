//! See [`motord_fuzz::setpoints`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::setpoints);
