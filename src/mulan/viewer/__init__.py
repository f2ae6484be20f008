"""The page a person drives: the field rendered live, with robots, covariances and proposed views in it."""
