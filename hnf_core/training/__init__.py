"""Fit F_Θ with torch: to recordings of one material, or to simulated strokes on many materials (the shared field).

Recordings or simulated strokes become spectra of short windows (`windows`, `simulated_strokes`), and the expected
spectra of the field are fitted to them by maximum likelihood (`likelihood`). Read
`from_recordings.train_from_recordings` first for one material, `train_shared.train_shared_field` for the shipped
weights. `tactile_map` trains the map predictor D_φ.
"""
