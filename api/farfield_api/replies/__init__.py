"""What routes answer: models with examples, from which the OpenAPI document is made. What an answer holds is checked."""
