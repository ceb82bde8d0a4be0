"""What `hnf bench` measures: time, memory and error side by side. No part of the Blender extension."""
