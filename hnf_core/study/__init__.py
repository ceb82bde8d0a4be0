"""Blinded two-alternative studies: plan, trials on an actuator or in a browser, responses, evaluation."""
