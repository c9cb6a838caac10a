//! Common parts of all HTML pages that this program writes as files.

/// Style sheet, for light and dark screens and for paper.
pub(crate) const STYLE: &str = include_str!("style.css");
/// Beginning of a page, up to its title. Its content security policy forbids scripts and everything
/// that would be loaded, since the texts of a recording may come from anywhere.
pub(crate) const HEAD: &str = "<!doctype html>\n<html lang=en><head><meta charset=utf-8>\
    <meta http-equiv=Content-Security-Policy content=\"default-src 'none'; \
    style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'\">\
    <meta name=viewport content=\"width=device-width, initial-scale=1\">\n";

/// Escapes a text for the body of an element or for an attribute.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
