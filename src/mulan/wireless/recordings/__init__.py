"""Channel state and ranges as real radios and published recordings store them, read strictly."""
