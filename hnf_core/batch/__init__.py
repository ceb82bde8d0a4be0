"""Many `hnf` commands on many workers: what is finished stays, what fails is told. No part of the Blender extension."""
