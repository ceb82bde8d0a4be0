"""Synthesise under a moving hand, strictly causally: one state in, the 5 ms of samples before it out.

`hand_tracker` turns pen and mouse events into states, `synthesis` renders them with the emission of `emission`, the
carriers of `carriers` and the pressing force of `contact_filter`. Read `synthesis.create_live_synthesis` first.
"""
