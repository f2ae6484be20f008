"""The hot operations, each once as a readable torch reference."""
