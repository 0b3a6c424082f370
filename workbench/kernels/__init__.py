"""Pure-array kernels: no I/O, deterministic, each tested against a plain reference."""
