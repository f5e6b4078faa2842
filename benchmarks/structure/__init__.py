"""Structure of the code: imports, files, the set-up of a recording, and patterns of its prose."""
