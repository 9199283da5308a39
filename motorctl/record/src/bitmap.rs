//! A picture of pixels, as a PNG. The letters are part of the program: a robot's computer may have
//! no font.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use plotters::prelude::DrawingBackend;
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingErrorKind};
use std::convert::Infallible;

/// Letter of a name that the font lacks.
const UNKNOWN: char = '?';

type Result<T> = std::result::Result<T, DrawingErrorKind<Infallible>>;

/// An image under work. Paths of some colours are dashed.
pub(crate) struct Bitmap<'a> {
    pixels: &'a mut [u8],
    size: (u32, u32),
    dashes: fn((u8, u8, u8)) -> &'static [u32],
    scale: u32,
}

impl<'a> Bitmap<'a> {
    /// Draws into `pixels`, three bytes each. `dashes` has the lengths of the lines and gaps of a
    /// colour, which `scale` multiplies; none for a continuous line.
    pub(crate) fn new(
        pixels: &'a mut [u8],
        size: (u32, u32),
        dashes: fn((u8, u8, u8)) -> &'static [u32],
        scale: u32,
    ) -> Self {
        Self { pixels, size, dashes, scale }
    }

    /// Returns the bytes of a pixel; `None` outside the picture.
    fn pixel(&mut self, (x, y): BackendCoord) -> Option<&mut [u8]> {
        let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        let is_inside = x < self.size.0 && y < self.size.1;
        let index = (y as usize * self.size.0 as usize + x as usize) * 3;
        self.pixels.get_mut(index..index + 3).filter(|_| is_inside)
    }
}

impl DrawingBackend for Bitmap<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        self.size
    }

    fn ensure_prepared(&mut self) -> Result<()> {
        Ok(())
    }

    fn present(&mut self) -> Result<()> {
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, colour: BackendColor) -> Result<()> {
        let BackendColor { alpha, rgb } = colour;
        if let Some(pixel) = self.pixel(point) {
            for (below, above) in pixel.iter_mut().zip([rgb.0, rgb.1, rgb.2]) {
                *below = (f64::from(*below) * (1.0 - alpha) + f64::from(above) * alpha).round() as u8;
            }
        }
        Ok(())
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Result<()> {
        let lengths = (self.dashes)(style.color().rgb);
        let mut pen = Pen::new(lengths, self.scale);
        let mut before: Option<BackendCoord> = None;
        for to in path {
            for (from, to) in before.iter().flat_map(|from| pen.draw(*from, to)).collect::<Vec<_>>() {
                self.draw_line(from, to, style)?;
            }
            before = Some(to);
        }
        Ok(())
    }

    fn estimate_text_size<T: BackendTextStyle>(&self, text: &str, style: &T) -> Result<(u32, u32)> {
        let height = height(style);
        let width = text.chars().count() * get_raster_width(FontWeight::Regular, height);
        Ok((width as u32, height.val() as u32))
    }

    fn draw_text<T: BackendTextStyle>(&mut self, text: &str, style: &T, at: BackendCoord) -> Result<()> {
        let (width, tall) = self.estimate_text_size(text, style)?;
        let (width, tall) = (width as i32, tall as i32);
        let anchor = style.anchor();
        let left = match anchor.h_pos {
            HPos::Left => 0,
            HPos::Center => -width / 2,
            HPos::Right => -width,
        };
        let top = match anchor.v_pos {
            VPos::Top => 0,
            VPos::Center => -tall / 2,
            VPos::Bottom => -tall,
        };
        let (height, colour) = (height(style), style.color());
        let glyphs = text.chars().filter_map(|letter| {
            let raster = |letter| get_raster(letter, FontWeight::Regular, height);
            raster(letter).or_else(|| raster(UNKNOWN))
        });
        for (index, glyph) in glyphs.enumerate() {
            let left = left + (index * glyph.width()) as i32;
            for (y, row) in (top..).zip(glyph.rows()) {
                for (x, intensity) in (left..).zip(row).filter(|(_, intensity)| **intensity > 0) {
                    let (x, y) = style.transform().transform(x, y);
                    let alpha = colour.alpha * f64::from(*intensity) / 255.0;
                    self.draw_pixel((at.0 + x, at.1 + y), BackendColor { alpha, ..colour })?;
                }
            }
        }
        Ok(())
    }
}

fn height(style: &impl BackendTextStyle) -> RasterHeight {
    if style.size() < 24.0 { RasterHeight::Size20 } else { RasterHeight::Size24 }
}

/// Divides a path into dashes, which continue over its corners.
struct Pen {
    lengths: &'static [u32],
    scale: u32,
    /// The present line or gap, and what is left of it.
    index: usize,
    left: f64,
}

impl Pen {
    fn new(lengths: &'static [u32], scale: u32) -> Self {
        let left = lengths.first().map_or(0.0, |length| f64::from(length * scale));
        Self { lengths, scale, index: 0, left }
    }

    /// Returns the lines of the way between two points.
    fn draw(&mut self, from: BackendCoord, to: BackendCoord) -> Vec<(BackendCoord, BackendCoord)> {
        if self.lengths.is_empty() {
            return vec![(from, to)];
        }
        let (dx, dy) = (f64::from(to.0 - from.0), f64::from(to.1 - from.1));
        let length = dx.hypot(dy);
        let at = |position: f64| {
            let part = position / length;
            (from.0 + (dx * part).round() as i32, from.1 + (dy * part).round() as i32)
        };
        let (mut position, mut lines) = (0.0, Vec::new());
        while position < length {
            let is_over = position + self.left <= length;
            let end = if is_over { position + self.left } else { length };
            if self.index.is_multiple_of(2) {
                lines.push((at(position), at(end)));
            }
            if is_over {
                self.index = (self.index + 1) % self.lengths.len();
                self.left = f64::from(self.lengths[self.index] * self.scale);
            } else {
                self.left -= end - position;
            }
            position = end;
        }
        lines
    }
}

/// Encodes pixels of three bytes as a PNG.
///
/// # Errors
///
/// The error of the encoder.
pub(crate) fn encode(pixels: &[u8], (width, height): (u32, u32)) -> std::result::Result<Vec<u8>, String> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
    writer.write_image_data(pixels).map_err(|error| error.to_string())?;
    writer.finish().map_err(|error| error.to_string())?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use plotters::prelude::{BLACK, IntoDrawingArea, PathElement, ShapeStyle, Text};
    use plotters::style::IntoFont;

    const SIZE: (u32, u32) = (100, 40);

    fn drawn(dashes: fn((u8, u8, u8)) -> &'static [u32], text: &str) -> Vec<u8> {
        let mut pixels = vec![255; 3 * 100 * 40];
        let area = Bitmap::new(&mut pixels, SIZE, dashes, 1).into_drawing_area();
        area.draw(&PathElement::new([(0, 5), (50, 5), (99, 5)], ShapeStyle::from(&BLACK))).unwrap();
        area.draw(&Text::new(text.to_owned(), (5, 10), ("sans-serif", 20).into_font())).unwrap();
        drop(area);
        pixels
    }

    fn dark(pixels: &[u8], rows: std::ops::Range<usize>) -> usize {
        pixels[rows.start * 300..rows.end * 300].chunks(3).filter(|pixel| pixel[0] < 128).count()
    }

    #[test]
    fn path_is_dashed_and_text_drawn() {
        let dashed = drawn(|_| &[4, 6], "N·m");
        assert!((40..=60).contains(&dark(&dashed, 5..6)), "{}", dark(&dashed, 5..6));
        assert_eq!(dark(&drawn(|_| &[], ""), 5..6), 100);
        assert!(dark(&dashed, 10..40) > 50);
        assert_eq!(drawn(|_| &[], "→"), drawn(|_| &[], "?"), "a letter that the font lacks");
    }

    /// Lengths of slanted lines are no multiples of the dashes: a rest that rounding left never
    /// ended.
    #[test]
    fn dashes_of_any_path_end() {
        let mut pen = Pen::new(&[7, 3], 2);
        let points = (0..2000).map(|step| (step, (step * 7919) % 541));
        let points: Vec<BackendCoord> = points.collect();
        let lines: usize = points.windows(2).map(|pair| pen.draw(pair[0], pair[1]).len()).sum();
        let length: f64 = points
            .windows(2)
            .map(|pair| f64::from(pair[1].0 - pair[0].0).hypot(f64::from(pair[1].1 - pair[0].1)))
            .sum();
        assert!((lines as f64) < length / 20.0 + 4000.0, "{lines} lines of {length} pixels");
    }

    #[test]
    fn file_is_a_png_of_its_size() {
        let file = encode(&drawn(|_| &[], "knee"), SIZE).unwrap();
        assert_eq!(&file[..8], b"\x89PNG\r\n\x1a\n");
        assert_eq!(file[16..24], [0, 0, 0, 100, 0, 0, 0, 40]);
    }
}
