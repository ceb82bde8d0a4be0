"""Runs inside the windowed Blender: plays a scenario's checks by simulated events and writes down what it saw.

Nothing here knows pytest; tests/app/session.py starts it and reads what it wrote.
"""
