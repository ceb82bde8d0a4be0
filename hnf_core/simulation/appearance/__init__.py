"""How a surface looks: colour, light and macro depth of a height tile, to learn touch from sight. A room of its own
inside the simulator: nothing here has a say in how a surface feels."""
