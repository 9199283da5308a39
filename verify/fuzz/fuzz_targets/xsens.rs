//! See [`motord_fuzz::xsens`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::xsens);
