"""What robots recorded: the types, the bag they are kept in, and the readers of other formats."""
