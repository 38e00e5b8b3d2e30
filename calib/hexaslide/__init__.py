"""The Hexa Slide: six sliders on fixed rails, six links, one platform with six freedoms."""
