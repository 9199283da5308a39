//! Programs that run: `motord`, its dead man's switch, `motord-sim`, and serial lines with the
//! clock of the wall.

mod deadman;
mod deadman_serial;
mod external_imu;
mod faults_process;
mod impostors;
mod log;
mod memory;
mod motord_sim;
mod outsider;
mod owners;
mod plant;
mod player;
mod port;
mod registrar;
mod safe_stop;
mod serial;
mod serial_imu;
mod serial_noise;
mod serial_process;
mod worst_moments;
