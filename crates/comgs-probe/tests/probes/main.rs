//! Tests of the crate as its users see it, in one program.

mod against_reference;
mod files;
mod fusion;
mod hard_cases;
mod round;
mod support;
mod threads;
mod wall;
