"""Tools for tubular organs: tube packing, swept surfaces, tube mesher, random waves."""
