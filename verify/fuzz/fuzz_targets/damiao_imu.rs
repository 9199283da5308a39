//! See [`motord_fuzz::damiao_imu`].

#![cfg_attr(fuzzing, no_main)]

motord_fuzz::program!(motord_fuzz::damiao_imu);
