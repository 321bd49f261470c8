//! The daemon with a board that shares nothing with it: the firmware's core and a model of the head in C
//! (`firmware/`), written from the documents. Where both sides would make the same mistake, the digital twin
//! shows nothing; this board does.

mod board;
mod codec;
mod conversation;
mod delay;
mod healthy;
mod microcontroller;
mod network;
mod observation;
mod situations;
mod table;
mod vectors;
mod verdicts;
