"""Tools that build any tubular organ: relaxed courses, random waves, well-shaped meshes."""
