"""A four-stroke marine diesel engine with turbocharger (Kougiatsos and Reppa 2024)."""
