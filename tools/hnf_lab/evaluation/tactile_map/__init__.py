"""How good predicted tactile maps are: as pictures, as slopes, and by the vibration that follows from them."""
