"""A scan of a tooth: reduced, asked, drawn. Usage: tooth.py VOLUME PICTURE.png"""

import sys

import isospan
import pyvista

volume, picture = sys.argv[1:3]
archive = isospan.reduce(volume, "tooth.isospan", target_rms="1%")
print(archive, f"{archive.info['bytes']} bytes, RMS error {archive.info['error']['rms']:.2f}")

spectrum = archive.spectrum()
print("worth a look:", spectrum.suggestions, "of", spectrum.range)
enamel, dentine = archive.surface([1000.5, 540])
print(enamel, dentine, sep="\n")

plotter = pyvista.Plotter(off_screen=True, window_size=(800, 800))
plotter.add_mesh(dentine.to_pyvista(), color="tan", opacity=0.4, smooth_shading=True)
plotter.add_mesh(enamel.to_pyvista(), color="white", smooth_shading=True)
plotter.view_vector((1, 1, 0.4), viewup=(0, 0, 1))
plotter.screenshot(picture)
