//! The cycle with simulated motors, on virtual time.

mod ambiguous;
mod busy_poll;
mod client_fuzz;
mod conventions;
mod cycle;
mod exclusion;
mod external_plant;
mod faults_bus;
mod faults_client;
mod faults_motor;
mod faults_time;
mod foreign;
mod gim;
mod horizon;
mod imu;
mod imu_can;
mod late;
mod mixed;
mod publication;
mod reads;
mod registers;
mod replay;
mod response;
mod transitions;
mod turns;
