"""Pure-array kernels: no I/O, no logging, deterministic; each is tested against a plain reference."""
