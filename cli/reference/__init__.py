"""Reference: what the code says of itself, as JSON Schemas and as pages of the documentation."""
