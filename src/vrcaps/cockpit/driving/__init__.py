"""Page of a drive: commands of its browsers, status, map, charts and recordings."""
