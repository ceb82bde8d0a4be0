"""The main job: a scene and its strokes → what a fingertip would feel, written to one folder."""
