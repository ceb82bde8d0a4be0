"""Synthesise the vibration of a stroke, with a neural field F_Θ(m, u) that modulates noise carriers.

m is a material, u the state of the hand (direction, speed, force). `stroke.StrokeInput` goes in, `stroke.Synthesis`
(acceleration in m/s² at 10 kHz or another rate) comes out. Read `synthesis.synthesise` first, then `field` (the
network), `linear_contact` (its physical prior) and `carriers` (the noise bands whose amplitudes the network outputs).
`live` synthesises under a moving hand, 5 ms at a time.
"""
