"""Measure an actuator: play an excitation, record its acceleration, estimate the response, and make a profile.

Read `frequency_response.py` first. `inverse_filter.py` turns a response into a compensation filter for playing.
"""
