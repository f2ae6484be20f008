"""Channel state as real cards and published recordings store it, read strictly."""
