//! Logs of CAN traffic, line by line: the formats of candump, of Vector (`.asc`) and of PEAK
//! (`.trc`).
//!
//! The first line decides the format. A line is parsed in a time that its length bounds, and
//! without allocation.

mod asc;
mod candump;
mod entry;
mod trc;

use motord_bus::candump::InvalidLine;

pub(super) use entry::{Entry, Source};

/// The format of the lines of one input.
#[derive(Debug, Default)]
pub(super) enum Log {
    /// No line yet.
    #[default]
    Unknown,
    Candump,
    Asc(asc::Header),
    Trc(trc::Columns),
}

impl Log {
    /// Parses the next line. `None` for a line without a frame, such as a comment.
    pub(super) fn parse<'a>(&mut self, line: &'a str) -> Result<Option<Entry<'a>>, InvalidLine> {
        if let Self::Unknown = self {
            *self = Self::of_first(line.trim());
        }
        match self {
            Self::Asc(header) => asc::parse(line, header),
            Self::Trc(columns) => trc::parse(line, columns),
            Self::Candump | Self::Unknown => candump::parse(line),
        }
    }

    /// Returns `true` when every line is a frame or a part of the format, and cannot be hexadecimal
    /// digits.
    pub(super) fn has_header(&self) -> bool {
        matches!(self, Self::Asc(_) | Self::Trc(_))
    }

    fn of_first(line: &str) -> Self {
        let begins = |words: &[&str]| words.iter().any(|word| line.starts_with(word));
        if begins(&[";"]) {
            Self::Trc(trc::Columns::default())
        } else if begins(&["date ", "base ", "// version"]) {
            Self::Asc(asc::Header::default())
        } else {
            Self::Candump
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::{Content, ErrorFrame, Format, Frame, FrameId, Unsupported};
    use proptest::prelude::*;

    /// The entries of `text`, as the time in microseconds, the source and the content.
    fn entries(text: &str) -> Vec<Result<(u128, String, Content), InvalidLine>> {
        let mut log = Log::default();
        let lines = text.lines().filter(|line| !line.trim().is_empty());
        let parsed = lines.filter_map(|line| log.parse(line).transpose());
        let plain = |entry: Entry<'_>| {
            let source = match entry.source {
                Source::Interface(name) => name.into(),
                Source::Channel(number) => number.to_string(),
            };
            (entry.at.map_or(0, |at| at.as_micros()), source, entry.content)
        };
        parsed.map(|entry| entry.map(plain)).collect()
    }

    fn data(id: u16, payload: &[u8]) -> Content {
        Content::Frame(Frame::new(FrameId::new(id).unwrap(), payload).unwrap())
    }

    fn extended(id: u32, payload: &[u8]) -> Content {
        Content::Frame(Frame::new(FrameId::extended(id).unwrap(), payload).unwrap())
    }

    fn fd(id: u16, format: Format, payload: &[u8]) -> Content {
        Content::Frame(Frame::with_format(FrameId::new(id).unwrap(), format, payload).unwrap())
    }

    fn report(class: u32, detail: u8) -> Content {
        Content::Error(ErrorFrame { class, data: [0, detail, 0, 0, 0, 0, 0, 0] })
    }

    const REMOTE: Content = Content::Unsupported(Unsupported::Remote);

    #[track_caller]
    fn assert_entries(text: &str, expected: &[(u128, &str, Content)]) {
        let expected: Vec<_> =
            expected.iter().map(|(at, source, content)| Ok((*at, (*source).into(), *content))).collect();
        assert_eq!(entries(text), expected);
    }

    #[test]
    fn every_form_of_candump_is_read() {
        assert_entries(
            "  vcan0  044   [2]  2A 36\n\
             \u{20}(1436509052.249713)  vcan0  044   [2]  2A 36   '*6'\n\
             \u{20}(000.001000)  can1  12345678   [0]\n\
             \u{20}(2015-07-10 06:17:32.249713)  vcan0  044  [02]  2A 36\n\
             \u{20}(2.5)  can0  RX B -  044  [02]  2A 36\n\
             (1436509052.249713) vcan0 044#2A36 R\n\
             \u{20} vcan0  123   [3]  remote request\n\
             \u{20} can0  20000044   [8]  00 20 00 00 00 00 00 00   ERRORFRAME\n\
             \tcontroller-problem{tx-error-passive},bus-off\n",
            &[
                (0, "vcan0", data(0x44, &[0x2A, 0x36])),
                (1_436_509_052_249_713, "vcan0", data(0x44, &[0x2A, 0x36])),
                (1000, "can1", extended(0x1234_5678, &[])),
                (1_436_509_052_249_713, "vcan0", fd(0x44, Format::FD, &[0x2A, 0x36])),
                (2_500_000, "can0", fd(0x44, Format::FD_BRS, &[0x2A, 0x36])),
                (1_436_509_052_249_713, "vcan0", data(0x44, &[0x2A, 0x36])),
                (0, "vcan0", REMOTE),
                (0, "can0", report(ErrorFrame::BUS_OFF | ErrorFrame::CONTROLLER, 0x20)),
            ],
        );
    }

    #[test]
    fn vector_log_is_read() {
        assert_entries(
            "date Sam Sep 30 15:06:13.191 2017\n\
             base hex  timestamps absolute\n\
             internal events logged\n\
             // version 9.0.0\n\
             Begin Triggerblock Sam Sep 30 15:06:13.191 2017\n\
             \u{20}  0.000000 Start of measurement\n\
             \u{20}  0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0\n\
             \u{20}  0.015991 CAN 2 Status:chip status error active\n\
             \u{20}  0.016000 CAN 2 Status:chip status busoff\n\
             \u{20}  1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n\
             \u{20}  2.501000 1 ErrorFrame\n\
             \u{20}  2.520002 3 200 Tx r Length = 1704000 BitCount = 145 ID = 512\n\
             \u{20}  3.098426 1  18EBFF00x       Rx d 2 01 A0   Length = 273910 BitCount = 141 ID = 418119424x\n\
             \u{20} 17.876708 2  6F9             Rx   d 3 05 0C 00  Length = 240015 BitCount = 124 ID = 1785\n\
             \u{20} 30.506898 CANFD   4 Rx        4EE          0 1 9 12 A1 02 03 04 00 00 00 00 00 00 00 00 1331984 11 303000\n\
             \u{20} 31.506898 CANFD   1 Rx        4EE  Name_2  1 0 2 2 b1 02 1331984 11 303000\n\
             End TriggerBlock\n",
            &[
                (15_991, "1", report(ErrorFrame::CONTROLLER, 0x30)),
                (16_000, "2", report(ErrorFrame::BUS_OFF, 0)),
                (2_501_000, "1", report(ErrorFrame::BUS_ERROR, 0)),
                (2_520_002, "3", REMOTE),
                (3_098_426, "1", extended(0x18EB_FF00, &[1, 0xA0])),
                (17_876_708, "2", data(0x6F9, &[5, 0x0C, 0])),
                (
                    30_506_898,
                    "4",
                    fd(
                        0x4EE,
                        Format::Fd { switches_rate: false, error_passive: true },
                        &[0xA1, 2, 3, 4, 0, 0, 0, 0, 0, 0, 0, 0],
                    ),
                ),
                (31_506_898, "1", fd(0x4EE, Format::FD_BRS, &[0xB1, 2])),
            ],
        );
    }

    #[test]
    fn decimal_and_relative_vector_log_is_read() {
        assert_entries(
            "base dec  timestamps relative\n0.5 1 68 Rx d 2 255 16\n0.25 1 68 Rx d 0\n",
            &[(500_000, "1", data(68, &[255, 16])), (750_000, "1", data(68, &[]))],
        );
    }

    #[test]
    fn peak_logs_of_all_versions_are_read() {
        let expected = |passive| {
            vec![
                (17_535_400, "1", extended(0x100, &[1, 2])),
                (17_540_300, "1", passive),
                (19_295_400, "1", data(0, &[0, 0xFF])),
                (19_300_000, "1", REMOTE),
            ]
        };
        let warning = report(ErrorFrame::CONTROLLER, 0x0C);
        for text in [
            ";$FILEVERSION=1.1\n\
             1)  17535.4  Tx  00000100  2  01 02\n\
             2)  17540.3  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY\n\
             3)  19295.4  Tx      0000  2  00 FF\n\
             4)  19300.0  Rx      0001  4  RTR\n",
            ";$FILEVERSION=1.3\n\
             1)  17535.4 1  Tx    00000100 -  2    01 02\n\
             2)  17540.3 1  Warng FFFFFFFF -  4    00 00 00 08  BUSHEAVY\n\
             3)  19295.4 1  Tx        0000 -  2    00 FF\n\
             4)  19300.0 1  Rx        0001 -  4    RTR\n",
            ";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,I,d,l,D\n\
             1     17535.400 DT 00000100 Tx 2  01 02\n\
             2     17540.300 ST          Rx    00 00 00 08\n\
             3     19295.400 DT     0000 Tx 2  00 FF\n\
             4     19300.000 RR     0001 Rx 4\n",
            ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n\
             1     17535.400 DT 1  00000100 Tx -  2    01 02\n\
             2     17540.300 ST 1         - Rx -  4    00 00 00 08\n\
             3     19295.400 DT 1      0000 Tx -  2    00 FF\n\
             4     19300.000 RR 1      0001 Rx -  4\n",
        ] {
            assert_entries(text, &expected(warning));
        }
    }

    #[test]
    fn oldest_and_fd_logs_of_peak_are_read() {
        assert_entries(
            ";##########\n;   PEAK 1.0\n 1)  1841  0001  2 00 FF\n 2) 2000 00000100 0\n 3) 2000 0001 4 RTR\n",
            &[
                (1_841_000, "1", data(1, &[0, 0xFF])),
                (2_000_000, "1", extended(0x100, &[])),
                (2_000_000, "1", REMOTE),
            ],
        );
        assert_entries(
            ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n\
             1 0.5 BI 2 0001 Rx - 9 00 01 02 03 04 05 06 07 08 09 0A 0B\n2 0.6 ST 2 - Rx - 4 00 00 00 10\n3 1 ER 2 - Rx - 5 04 00 02 00 00\n",
            &[
                (
                    500,
                    "2",
                    fd(
                        1,
                        Format::Fd { switches_rate: true, error_passive: true },
                        &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
                    ),
                ),
                (600, "2", report(ErrorFrame::BUS_OFF, 0)),
                (1000, "2", report(ErrorFrame::BUS_ERROR, 0)),
            ],
        );
    }

    #[test]
    fn damaged_lines_are_refused_and_next_one_read() {
        for (text, wrong) in [
            ("can0 044 [3] 2A 36", InvalidLine::Shape),
            ("can0 044 [2] 2A 3G", InvalidLine::Data),
            ("can0 844 [0]", InvalidLine::Id),
            ("can0 044 [1] 2A 36", InvalidLine::Shape),
            ("(2015-02-30 06:17:32.249713) can0 044 [0]", InvalidLine::Time),
            ("base hex\n0.5 1 844 Rx d 0", InvalidLine::Id),
            ("base hex\n0.5 1 44 Rx d 3 00", InvalidLine::Shape),
            (";\n1) 0.5 Rx 0800 0", InvalidLine::Id),
            (";\n1) x Rx 0001 0", InvalidLine::Time),
            (";\n1) 0.5 Rx 0001 3 00 01", InvalidLine::Shape),
        ] {
            assert_eq!(entries(text), [Err(wrong)], "{text}");
        }
    }

    proptest! {
        #[test]
        fn no_line_makes_the_parsers_panic(
            header in prop::sample::select(vec!["", ";", ";$COLUMNS=N,O,T,I,d,l,D", "base hex", "base dec timestamps relative"]),
            lines in prop::collection::vec(
                prop_oneof![
                    any::<String>(),
                    "[0-9]{1,3}\\)? [0-9]{1,20}\\.[0-9]{0,10} (DT|FD|RR|ST|ER|Rx|Warng|1 Tx|CANFD|CAN) ?[0-9A-Fx -]{0,40}",
                    "(\\([0-9.: -]{0,30}\\) )?can0 (RX - - )?[0-9A-F]{0,9}(  \\[[0-9]{1,3}\\]|#+)[0-9A-FR ]{0,40}",
                ],
                0..8,
            ),
        ) {
            let _read = entries(&format!("{header}\n{}", lines.join("\n")));
        }
    }
}
