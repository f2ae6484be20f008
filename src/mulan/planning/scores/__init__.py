"""What a further view would be worth: every rule for choosing views, behind one interface."""
