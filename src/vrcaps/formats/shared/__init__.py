"""Functions shared by formats: folders, tables, images, cameras."""
