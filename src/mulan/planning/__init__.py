"""Which view is worth the trip, for each robot and for the team."""
