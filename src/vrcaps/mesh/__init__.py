"""Triangle meshes: files, repair, measures; nothing here knows of a gut."""
