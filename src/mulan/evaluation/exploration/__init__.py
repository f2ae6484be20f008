"""Robots that choose their own views: they move, photograph, measure, localize, learn and plan."""
