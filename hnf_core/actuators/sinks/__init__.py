"""Sinks for real outputs: serial devices, sound outputs, OSC receivers and files.

Each implements the interface in `hnf_core/actuators/sink.py`.
"""
