"""How the wall moves and resists: material, drag, quick deformation, muscle."""
