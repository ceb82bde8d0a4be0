"""Compiled inner loops of hnf_core.kernel, which loads them."""
