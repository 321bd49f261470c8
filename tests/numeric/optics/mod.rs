//! The sensor model and its inverse, on the nominal head and on other heads.

mod beam;
mod elliptical;
mod fusion;
mod heads;
mod robustness;
mod round_trip;
mod slopes;
