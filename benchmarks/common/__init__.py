"""Options of scripts, sections of pages and digests of sources."""
