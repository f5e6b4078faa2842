"""Formats that pack samples into large files: WebDataset, Hugging Face."""
