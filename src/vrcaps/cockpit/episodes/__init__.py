"""Page of recorded episodes: scene, charts and player."""
