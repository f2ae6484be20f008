"""One section of the report a file; each turns what the run holds into HTML, or says what is missing."""
