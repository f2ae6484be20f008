"""Readers of public radio recordings, each strict about its one layout."""
