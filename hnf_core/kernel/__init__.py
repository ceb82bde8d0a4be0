"""Compiled C functions for F_Θ and its carriers, loaded through ctypes.

Every function has a numpy implementation in `hnf_core.field` that computes the same where no kernel is installed.
`loader` finds the library, `compiled_field` evaluates F_Θ, `compiled_carriers` renders carriers and filters. Read
`loader` first; the C sources and their header `hnf_kernel.h` are in `source/`.
"""
