"""One file a noun; each translates HTTP to the store and back."""
