"""Looking at the result: the animated page and the figures. Nothing here is imported before it is used."""
