"""An uplift file in the forms that other renderers read: RGB maps, pbrt-v4's lights, Mitsuba without a plugin.

Every form writes a folder with the maps, a snippet or script to use them, and a README.md that says what is lost.
"""
