"""Train the shared field, whose weights are shipped, on simulated strokes over many materials."""
