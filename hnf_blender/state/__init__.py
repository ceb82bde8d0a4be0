"""What the add-on remembers while Blender runs and a file does not keep: statuses, the running job, previews."""
