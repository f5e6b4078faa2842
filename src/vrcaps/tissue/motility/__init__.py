"""How the gut's muscle contracts: rhythm, waves and the migrating motor complex."""
