"""The face of glidecal: commands, screens, exports. Knows typer, rich and Textual."""
