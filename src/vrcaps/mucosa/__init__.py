"""How the wall looks: textures and their baking."""
